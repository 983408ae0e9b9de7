"""Fits, their uncertainty, and their files; nothing here moves an arm."""
