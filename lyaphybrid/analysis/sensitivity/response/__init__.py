"""The linear response of averages in chaos: derivatives along unstable directions, and what they need."""
