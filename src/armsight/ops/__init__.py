"""What armsight does: one function an action, whose signature is its only declaration.

The modules of actions load nothing that takes long, for a command's flags and help are made of their signatures.
"""
