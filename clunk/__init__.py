"""Impact regime maps of drivelines with backlash."""

__version__ = "0.1.0"
