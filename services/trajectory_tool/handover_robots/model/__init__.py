"""Values: joints, poses, shapes, trajectories and what a robot is. Without I/O and without other folders."""
