"""What ``ros2 node info`` tells about one node: names and types of its endpoints."""


def publishers_of(domain, node):
    return {p.topic: p.msgtype for p in domain.publishers() if p.node == node}


def subscriptions_of(domain, node):
    return {s.topic: s.msgtype for s in domain.subscriptions() if s.node == node}


def services_of(domain, node):
    return {offer.name: offer.type for offer, _ in domain.services if offer.node == node}


def clients_of(domain, node):
    return {offer.name: offer.type for offer, clients in domain.services if node in clients}


def action_servers_of(domain, node):
    return {offer.name: offer.type for offer, _ in domain.actions if offer.node == node}


def action_clients_of(domain, node):
    return {offer.name: offer.type for offer, clients in domain.actions if node in clients}
