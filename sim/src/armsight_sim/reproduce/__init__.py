"""The papers' experiments on emulated hardware: their own methods and armsight's, beside the printed figures."""
