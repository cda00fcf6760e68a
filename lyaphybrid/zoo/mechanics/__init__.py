"""Impacts, friction and walking."""
