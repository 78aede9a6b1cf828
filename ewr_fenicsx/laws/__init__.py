"""Contact laws, a file a law: non-smooth equations at samples in time, and what a user says of them."""
