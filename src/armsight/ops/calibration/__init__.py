"""Images, poses or measurements in; cameras, rigs, targets, hand-eye, tool tip or arms out."""
