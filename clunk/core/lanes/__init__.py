"""Many items side by side in a processor's vector registers: the registers, and the queues that fill them.

Nothing here knows what the items are.
"""
