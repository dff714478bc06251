"""Many runs side by side in a processor's vector registers; this knows no physics."""
