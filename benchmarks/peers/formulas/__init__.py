"""The equations, each once, for every program."""
