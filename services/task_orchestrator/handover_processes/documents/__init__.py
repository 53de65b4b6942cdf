"""The documents of the REST interface: requests, responses, views of processes and Tasks."""
