"""Perception: from a depth image of a bin to parts and ranked grasps. A pure library without I/O.

It needs the extra `physics` (OpenCV) and knows no simulation: a real depth camera gives the same images.

    depth_image     distances with the intrinsics of the camera, as points
    segmentation    faces of parts in a bin, and the poses of the parts
    grasps          grasps of a part, checked against the bin and the other parts, best first
    hand_eye        where a camera is mounted, from images of a ball
"""
