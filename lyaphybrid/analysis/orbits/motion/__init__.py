"""The motion around an orbit, the sizes of its components, and where it first comes back."""
