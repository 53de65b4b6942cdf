"""Activities of daily living from an IMU at the wrist and a pressure mat, after ROS4HC (3.2.1)."""
