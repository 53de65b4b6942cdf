"""Sensors of people: each measurement becomes a `PeopleReport` for the limits of the robots.

A scan or a depth image is compared with the scene and the robots: what lies on neither is a person. Places
are also read from Person entities. A sensor that no longer reports is silent, and counts as a person at the
robot. Nothing here is a safety-rated function.
"""
