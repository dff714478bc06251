"""The exact method: by modes, over spans for which it is proved that no guard turns negative."""
