"""Camera and hand together, from a board seen at many poses of the arm."""
