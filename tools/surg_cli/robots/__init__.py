"""What a person does to real and emulated arms: examine, power, request, rehearse."""
