"""From a scene to its contact problem: mesh, sparse matrices, interface, modes and component mode synthesis."""
