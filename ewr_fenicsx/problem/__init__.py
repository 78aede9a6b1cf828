"""What is to be solved: a reduced model, laws at its pairs, a frequency and harmonics, composed to a contact system."""
