"""What a user asks for in a file: a validated scene, what is doubtful in it, and the effects that it calls for."""
