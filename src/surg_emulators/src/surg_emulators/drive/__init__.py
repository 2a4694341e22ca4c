"""Servos with Dynamixel protocol 2.0 as a program, written from the maker's documents."""
