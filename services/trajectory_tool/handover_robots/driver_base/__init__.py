"""The base of robot drivers: the interface `Robot`, what a driver receives, and its control cycles.

Our drivers and those of other packages stand on it; nothing in it knows a driver.
"""
