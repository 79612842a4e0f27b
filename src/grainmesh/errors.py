"""The one exception for a user's mistake."""


class InputError(ValueError):
    """Input that cannot be used; its message is one plain line that says what to do.

    The command line prints the message on stderr and exits with status 2.
    """
