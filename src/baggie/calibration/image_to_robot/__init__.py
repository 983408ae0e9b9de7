"""From the picture straight to the robot's plane."""
