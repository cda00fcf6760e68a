"""Evolvers: how each class of systems is advanced by one step, iteration or event."""
