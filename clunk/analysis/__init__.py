"""Analysis of maps: differences between two, agreement with measurements and between methods, sensitivity."""
