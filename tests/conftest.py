"""What holds for all tests: Ctrl-C is heard however they were started, and nothing here is about speed.

Laws are tried on a few examples, which are others each time; `--hypothesis-profile thorough` takes many.
"""

import signal

from hypothesis import settings

# A shell that starts something with & makes it deaf to Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("quick", deadline=None, max_examples=25)
settings.register_profile("thorough", deadline=None, max_examples=200)
settings.load_profile("quick")
