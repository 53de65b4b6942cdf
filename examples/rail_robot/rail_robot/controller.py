"""A stand-in for the library of a manufacturer: replace it with that of your controller."""

Values = tuple[float, ...]


class Controller:
    """Joints that are at each commanded position at once, and a gripper."""

    def __init__(self, positions: Values, *, is_closed: bool) -> None:
        self.joints = (positions, (0.0,) * len(positions))
        self.is_closed = is_closed

    def go_to(self, positions: Values, velocities: Values) -> None:
        """Send the joints to positions, which they pass at velocities."""
        self.joints = (positions, velocities)

    def move_by_hand(self, displacements: Values) -> None:
        """Move the joints as a person does who guides the arm."""
        positions = tuple(map(sum, zip(self.joints[0], displacements, strict=True)))
        self.joints = (positions, (0.0,) * len(positions))
