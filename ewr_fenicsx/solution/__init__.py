"""What comes out: a periodic solution, the histories and figures that are read off it, and what it leaves open."""
