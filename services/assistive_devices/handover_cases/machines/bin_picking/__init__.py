"""The operator of the bin-picking cell: strain slows the robot, a lasting one proposes a break."""
