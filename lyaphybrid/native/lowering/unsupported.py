"""What the compiler does not take."""


class UnsupportedError(Exception):
    """A program that this compiler does not take; the message names the primitive, or the type."""
