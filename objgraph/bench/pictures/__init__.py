"""Contact sheets of shapes and worlds."""
