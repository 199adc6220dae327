"""The offline side, free of ROS: bags, net feedback, comparison, diagnosis and report."""
