"""What runs give: labelled numbers, files and pictures. Nothing here imports JAX."""
