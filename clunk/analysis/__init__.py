"""What maps say: differences between them, agreement with measurements and between methods, sensitivity."""
