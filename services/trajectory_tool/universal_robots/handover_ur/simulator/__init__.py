"""A controller of Universal Robots as a peer of our own: for tests, and for dry runs without an arm.

It speaks RTDE, dashboard, script interface and the socket of the Robotiq URCap, and moves six joints. Its
states and limits follow the published behaviour; it was never compared with a real controller.
"""
