"""A camera and a robot that both know where the world is, and so each other."""
