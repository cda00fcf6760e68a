"""How each class of systems goes from one event to the next, as the loop asks for it."""
