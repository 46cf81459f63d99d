"""What others do, each as its own users would."""
