"""Transporter Networks: what was picked is searched for, turned, in the picture of where it may go."""
