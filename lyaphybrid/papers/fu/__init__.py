"""Fu, Wang & Wang (2004), systems with dry friction: its checks, figures and report."""
