"""Bags, data sets and pictures as the programs of others write them."""
