"""Guard, servo, teach, play."""
