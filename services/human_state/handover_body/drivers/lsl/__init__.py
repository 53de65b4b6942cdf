"""Any stream of the Lab Streaming Layer."""
