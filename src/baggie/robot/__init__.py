"""Arms: what one must offer, how it moves, the gate every motion passes; real ones, too.

Kinematics runs on MuJoCo, which reads how to render when it is first imported.
"""

from baggie.gl import choose_backend

choose_backend()
