"""The structure as the contact solver knows it: a reduced model, its compliance at the contact rows, its statics."""
