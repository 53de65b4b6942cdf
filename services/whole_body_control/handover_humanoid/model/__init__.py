"""The semantic model of a humanoid: what URDF, SRDF and `robot.yaml` say, checked and frozen."""
