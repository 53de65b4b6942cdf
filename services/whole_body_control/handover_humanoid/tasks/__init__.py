"""Tasks and constraints of a stack of tasks: small classes that know kinematics, and no solver."""
