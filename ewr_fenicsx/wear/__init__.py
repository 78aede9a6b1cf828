"""Fretting wear over many cycles: Archard's law on a slow time scale."""
