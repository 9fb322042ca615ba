"""What a person does with path.csv: change it, check it for an arm, give it to a controller, make one from pictures."""
