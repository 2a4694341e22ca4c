"""What is wrong with a data set: findings by episode, of rows, of pictures, of the set."""
