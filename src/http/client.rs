//! Who calls, as far as the network tells.

use std::net::IpAddr;

/// The address that a request comes from, for limits and the audit log. It is in no other log: it may name a person's workstation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct ClientAddress(pub(super) IpAddr);
