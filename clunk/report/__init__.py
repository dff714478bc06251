"""The report by Boere (2008): its claims, figures and measured tables, recomputed."""
