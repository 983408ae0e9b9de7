"""The MuJoCo world."""

from baggie.gl import choose_backend

choose_backend()
