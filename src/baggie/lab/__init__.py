"""The virtual lab: a simulated workcell that is reached as a real robot is."""

from baggie.gl import choose_backend

choose_backend()
