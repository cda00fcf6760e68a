"""Billiards and hard bodies."""
