"""The motion of minimum jerk from 0 to 1, at rest at both ends (Flash and Hogan 1985).

Its share of the way s(t) = 10 t³ - 15 t⁴ + 6 t⁵ for a share of the time t in [0, 1].
"""


def moved(share: float) -> float:
    """Return the share of the way after a share of the time."""
    return share**3 * (10.0 + share * (6.0 * share - 15.0))


def rate(share: float) -> float:
    """Return the speed, in ways for each duration."""
    return 30.0 * share**2 * (1.0 - share) ** 2


def moved_integral(share: float) -> float:
    """Return the integral of `moved` from 0; at 1 it is 1/2."""
    return share**4 * (2.5 + share * (share - 3.0))
