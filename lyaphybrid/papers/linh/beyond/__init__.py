"""What the paper names and does not compute: other methods, other forms of equations, a large network."""
