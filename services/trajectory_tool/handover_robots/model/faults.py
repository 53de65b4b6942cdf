"""Why a robot does not move: the robot itself, its reach, or what is in the way."""

from handover.errors import HandoverError, TranslatedError


class RobotFault(TranslatedError):
    """The robot cannot move; the message has the reason and the remedy."""


class UnknownOutcome(RobotFault):
    """An act was commanded, and nobody knows whether it is, or will be, carried out."""


class LeaseEnded(RobotFault):
    """This process does not hold the lease of the robot (any more): nothing is sent to it."""


class Unreachable(HandoverError):
    """The robot cannot reach a pose or a joint position; the message has the distance or the limit."""


class NoPath(TranslatedError):
    """Something is in the way; the message names what would touch, or that no way was found in time."""
