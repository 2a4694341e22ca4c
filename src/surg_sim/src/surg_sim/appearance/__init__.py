"""What is only looked at: meshes, materials, the room, and off-screen pictures."""
