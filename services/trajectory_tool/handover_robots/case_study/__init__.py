"""The case study of the IoHRT paper in simulated physics: pick and place of eight objects by shared control.

- `trial`: one object, one mode, one seed, through the control loop of the product; measures what happened.
- `operators`: who holds the dead-man control: a simulated person, or a supervisor of the autonomous motion.
- `seen`: what a person sees of the scene.
- `report`: Table I of the paper beside the trials, as text, CSV and JSON.

It needs the extra `physics`.
"""
