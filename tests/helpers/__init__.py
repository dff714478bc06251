"""What several tests use: an independent reference, random drivelines, running the command."""
