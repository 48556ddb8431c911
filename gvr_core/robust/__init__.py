"""What mends the weak places of the paper's method, each in a file of its own."""
