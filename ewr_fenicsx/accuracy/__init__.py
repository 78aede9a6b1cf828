"""What accuracy costs: errors estimated from solutions, and the cheapest solve that is accurate enough."""
