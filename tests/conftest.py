"""What holds for all tests: Ctrl-C is heard however they were started, and nothing here is about speed."""

import signal

from hypothesis import settings

# A shell that starts something with & makes it deaf to Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
