"""Makes a robot folder from a URDF of anybody, with a report of what is missing or odd.

sources    where a URDF and its meshes are: files, ROS packages, example-robot-data
urdf       the tree of links and joints, checked and completed
shapes     capsules, boxes and spheres in place of meshes
semantics  pairs of links that never collide, and a home position
add        all of it; writes the folder
"""
