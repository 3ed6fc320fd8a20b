//! How the service is reached: encrypted or not, by either HTTP, by clients that do not behave. Each test has a service in a process of its own.

mod child;
mod client;
mod encryption;
mod limits;
