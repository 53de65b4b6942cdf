"""The glove bridge: sends the values of a glove as frames over TCP.

It runs on the computer that the glove is paired with, also on Windows. It needs only Python, and pyserial for
a glove on a serial port.
"""
