"""The two exceptions for users: input that cannot be used, a run that cannot go on."""


class InputError(ValueError):
    """Input that cannot be used; its message is one plain line that says what to do.

    The command line prints the message on stderr and exits with status 2.
    """


class RunError(RuntimeError):
    """A run that cannot go on; its message is one plain line that says what happened and when."""
