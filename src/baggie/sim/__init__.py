"""The MuJoCo world."""

from baggie.sim.gl import choose_backend

choose_backend()
