"""Pictures of a simulation, and the window of the render mode `human`."""
