"""Pictures: no JAX, and nothing here simulates."""
