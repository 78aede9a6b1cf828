"""The weighted residual of a contact system: its value, its derivative, Newton's steps, and the motion found."""
