"""The console's pages: each shows, asks and calls; what is done stands in armsight.app."""
