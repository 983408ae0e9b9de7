"""The `keypoint` policy: finds thing and goal in the picture, and knows where that is for the robot."""
