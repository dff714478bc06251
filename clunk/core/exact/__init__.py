"""The exact method: regimes are solved by modes, over spans for which it is proved that no guard turns negative."""
