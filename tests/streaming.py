"""Work that goes to processes of its own, done here: what costs most of a short test is their start."""


def stream_here(open_worker, tasks, _workers, _answer=None):
    """In place of `stream_in_processes`, whose own behaviour is tested where it is made."""
    run = open_worker()
    for task in tasks:
        yield from run(task)
