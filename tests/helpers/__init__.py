"""What tests share: stand-ins for arms, cameras, people and the Ravens benchmark, and pictures made to order."""
