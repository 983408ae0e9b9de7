"""What a person does once for each workcell: calibrate it step by step, check it, and keep watch over it."""
