//! Settings of DICOM associations: where they come in, whose they are, and what encrypts them.

use super::{ConfigError, owner};
use crate::{dimse::is_ae_title, jobs::ANONYMOUS};
use clap::{Args, builder::BoolishValueParser};
use std::{net::SocketAddr, path::PathBuf};

/// How DICOM associations are taken.
#[derive(Debug, Clone, Args)]
pub struct DimseSettings {
    /// Address and port to listen on for DICOM associations (C-STORE, C-ECHO); port 0 takes a free one and prints it. None by default.
    #[arg(id = "dimse_listen", long = "dimse-listen", env = "VENTRICLE_DIMSE_LISTEN")]
    pub listen: Option<SocketAddr>,

    /// AE title of this service.
    #[arg(id = "dimse_ae_title", long = "dimse-ae-title", env = "VENTRICLE_DIMSE_AE_TITLE", default_value = "VENTRICLE", value_parser = ae_title)]
    pub ae_title: String,

    /// Calling AE titles that may associate, separated by commas; any if none is named, which only a loopback address allows.
    #[arg(id = "dimse_calling_ae", long = "dimse-calling-ae", env = "VENTRICLE_DIMSE_CALLING_AE", value_delimiter = ',', value_parser = ae_title)]
    pub calling_ae: Vec<String>,

    /// Confirms that only those callers reach the address of DICOM associations: needed for anything but a loopback address, since anybody can
    /// give an AE title.
    #[arg(id = "dimse_trusted_network", long = "dimse-trusted-network", env = "VENTRICLE_DIMSE_TRUSTED_NETWORK", value_parser = BoolishValueParser::new())]
    pub trusted_network: bool,

    /// Owner of the jobs that come by DICOM associations: who has a key or token of the same owner sees them.
    #[arg(id = "dimse_owner", long = "dimse-owner", env = "VENTRICLE_DIMSE_OWNER", default_value = ANONYMOUS, value_parser = owner)]
    pub owner: String,

    /// DICOM associations at once; more are rejected for the moment.
    #[arg(id = "dimse_max_associations", long = "dimse-max-associations", env = "VENTRICLE_DIMSE_MAX_ASSOCIATIONS", default_value = "8", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub max_associations: u16,

    /// PEM file of the certificate with which DICOM associations are encrypted, and of the authorities between. Needs its key.
    #[arg(id = "dimse_tls_cert", long = "dimse-tls-cert", env = "VENTRICLE_DIMSE_TLS_CERT")]
    pub tls_cert: Option<PathBuf>,

    /// PEM file of the key of that certificate, without a password.
    #[arg(id = "dimse_tls_key", long = "dimse-tls-key", env = "VENTRICLE_DIMSE_TLS_KEY")]
    pub tls_key: Option<PathBuf>,
}

impl DimseSettings {
    /// Checks what no single setting can say.
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if let Some(listen) = self.listen.filter(|listen| !listen.ip().is_loopback())
            && (!self.trusted_network || self.calling_ae.is_empty())
        {
            return Err(ConfigError::DimseExposed { listen });
        }
        if self.tls_cert.is_some() != self.tls_key.is_some() {
            return Err(ConfigError::DimseTls);
        }
        Ok(())
    }

    /// Certificate and key, where associations are encrypted.
    pub fn tls(&self) -> Option<(&PathBuf, &PathBuf)> {
        self.tls_cert.as_ref().zip(self.tls_key.as_ref())
    }
}

/// An AE title (PS3.5 table 6.2-1).
fn ae_title(text: &str) -> Result<String, String> {
    if is_ae_title(text) {
        return Ok(text.to_owned());
    }
    Err("an AE title has 1 to 16 printable ASCII characters, no backslash and no space at its ends.".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ServeSettings;

    fn settings(flags: &[&str]) -> ServeSettings {
        ServeSettings::from_flags(flags.iter().copied()).unwrap()
    }

    #[test]
    fn dicom_from_outside_needs_callers_and_an_acknowledgement() {
        let open = ["--dimse-listen", "0.0.0.0:104"];
        let (callers, proxy) = (["--dimse-calling-ae", "PACS,CAMERA 2"], ["--dimse-trusted-network"]);
        for flags in [open.to_vec(), [&open[..], &callers].concat(), [&open[..], &proxy].concat()] {
            assert!(matches!(settings(&flags).validate(), Err(ConfigError::DimseExposed { .. })), "{flags:?}");
        }
        let both = settings(&[&open[..], &callers, &proxy].concat());
        both.validate().unwrap();
        assert_eq!(both.dimse.calling_ae, ["PACS", "CAMERA 2"]);
        settings(&["--dimse-listen", "[::1]:11112"]).validate().unwrap();
        assert_eq!(settings(&["--dimse-tls-cert", "a.pem"]).validate(), Err(ConfigError::DimseTls));
        for wrong in ["", "SEVENTEEN_LETTERS", "A\\B", " A"] {
            assert!(ServeSettings::from_flags(["--dimse-ae-title", wrong]).is_err(), "{wrong}");
        }
    }
}
