"""What `ewr` runs: a study of a scene, what there is to say of it, and what its accuracy costs."""
