"""The linear response of averages in chaos: derivatives along the unstable direction."""
