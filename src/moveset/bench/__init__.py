"""What motion costs: time, memory and operations of every way to make it, and the page that shows them."""
