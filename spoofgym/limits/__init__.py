"""How far an attack can go unseen, whoever looks."""
