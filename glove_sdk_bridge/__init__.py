"""The glove bridge: a glove becomes frames on a TCP stream.

It runs on the machine that the glove is paired with, Windows included, and needs nothing but Python
(and pyserial, where the glove hangs on a serial port).
"""
