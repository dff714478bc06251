"""The exact method: by modes, over spans in which it is proved that no guard turns negative."""
