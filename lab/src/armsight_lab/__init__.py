"""What laboratories use: many runs at once, rigs and motions planned. armsight reaches it by entry points."""
