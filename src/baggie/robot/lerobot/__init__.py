"""Robots with LeRobot's interface."""
