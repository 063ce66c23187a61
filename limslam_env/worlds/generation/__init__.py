"""Random floor plans: the layout of the rooms, their furniture, and the finished world."""
