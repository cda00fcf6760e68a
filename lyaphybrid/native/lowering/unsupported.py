"""The error for programs that the compiler cannot take."""


class UnsupportedError(Exception):
    """A program that this compiler cannot take; the message names the primitive, or the type."""
