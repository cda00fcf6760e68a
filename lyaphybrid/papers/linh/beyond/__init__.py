"""What the paper names but does not compute: other methods, other forms of equations, a large network."""
