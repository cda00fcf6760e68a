"""What the compiler does not take."""


class Unsupported(Exception):
    """A program that this compiler does not take; the message names the primitive, or the type."""
