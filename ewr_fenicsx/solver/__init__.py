"""The ways to a solution: Newton's method, warm and cold starts, the ladder of fallbacks, and steps in time."""
