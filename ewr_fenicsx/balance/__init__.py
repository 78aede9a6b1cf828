"""The weighted residual of a contact system: its value, its derivative and the steps of Newton's method."""
