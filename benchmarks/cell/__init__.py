"""What people and robots see of a whole cell: the broker, processes, devices, many clients and cells."""
