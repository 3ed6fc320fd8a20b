//! Tokens of an OpenID provider (RFC 7519, RFC 9068): what must hold of one, and whom it names.

use super::{Scope, is_owner, signature};
use jiff::{SignedDuration, Timestamp};
use jsonwebtoken::{
    DecodingKey, Header, Validation, decode, decode_header,
    errors::ErrorKind,
    jwk::{Jwk, KeyAlgorithm},
};
use serde_json::{Map, Value};

/// Why a token is not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    /// Not a token at all.
    #[error("What follows `Bearer` is neither an API key of this service nor a JSON Web Token.")]
    NoToken,
    /// Signed by an algorithm that is not accepted, or not at all.
    #[error("The token is signed by an algorithm that is not accepted here. Accepted are RS, PS, ES (256, 384; RS and PS 512) and EdDSA.")]
    Algorithm,
    /// Signed with a key that the provider does not publish.
    #[error("The token is signed with a key that its issuer does not publish.")]
    UnknownKey,
    /// The signature is wrong.
    #[error("The token's signature is wrong.")]
    Signature,
    /// Its time is over.
    #[error("The token has expired. Get another from its issuer.")]
    Expired,
    /// Its time has not come.
    #[error("The token is not valid yet. Do the clocks of issuer and service agree?")]
    NotYet,
    /// Of another issuer, for another service, or without a claim.
    #[error("The token's claim `{0}` is missing or another than this service expects.")]
    Claim(String),
    /// It names no owner.
    #[error("The token's claim `{0}`, which names the owner of jobs, is missing or no text of 1 to 128 characters.")]
    NoOwner(String),
    /// The provider's keys are not to be had.
    #[error("The keys of the tokens' issuer cannot be fetched at the moment. Send the request again in a few seconds.")]
    Unavailable,
}

/// What a token must hold.
#[derive(Debug, Clone)]
pub struct Expected {
    /// Who issues tokens: the claim `iss`, to the letter.
    pub issuer: String,
    /// Whom they are for: one of the claim `aud`.
    pub audience: String,
    /// The claim that names the owner of jobs.
    pub owner_claim: String,
    /// The claim with the scopes: a text with spaces between them, or a list.
    pub scope_claim: String,
    /// What stands before a scope's name there.
    pub scope_prefix: String,
    /// Seconds by which clocks may differ.
    pub leeway_s: u64,
}

/// Whom a token names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Bearer {
    pub(super) owner: String,
    pub(super) subject: String,
    pub(super) scopes: Vec<Scope>,
    pub(super) expires_at: Timestamp,
}

/// The token's header, if its algorithm is one that is accepted.
pub(super) fn header(token: &str) -> Result<Header, TokenError> {
    signature::install();
    let header = decode_header(token).map_err(|error| match error.kind() {
        // As `none`, which is no algorithm of the library's.
        ErrorKind::Json(_) if token.split('.').count() == 3 => TokenError::Algorithm,
        _ => TokenError::NoToken,
    })?;
    if signature::ALGORITHMS.contains(&header.alg) { Ok(header) } else { Err(TokenError::Algorithm) }
}

/// Reads a token that is signed with this key.
pub(super) fn read(token: &str, header: &Header, key: &Jwk, expected: &Expected) -> Result<Bearer, TokenError> {
    // A key says what it is for; what it leaves out is not held against it.
    if key.common.key_algorithm.is_some_and(|of_key| of_key != KeyAlgorithm::from(header.alg)) {
        return Err(TokenError::Algorithm);
    }
    let key = DecodingKey::from_jwk(key).map_err(|_| TokenError::UnknownKey)?;
    let mut validation = Validation::new(header.alg);
    validation.leeway = expected.leeway_s;
    validation.validate_nbf = true;
    validation.set_issuer(&[&expected.issuer]);
    validation.set_audience(&[&expected.audience]);
    validation.set_required_spec_claims(&["exp", "iss", "aud", "sub"]);
    let claims = decode::<Map<String, Value>>(token, &key, &validation).map_err(|error| refused(error.kind()))?.claims;
    let text = |claim: &str| claims.get(claim).and_then(Value::as_str).map(str::to_owned);
    let owner =
        text(&expected.owner_claim).filter(|owner| is_owner(owner)).ok_or_else(|| TokenError::NoOwner(expected.owner_claim.clone()))?;
    let subject = text("sub").filter(|subject| is_owner(subject)).ok_or_else(|| TokenError::Claim("sub".to_owned()))?;
    let expires_at = claims.get("exp").and_then(Value::as_f64).and_then(|seconds| Timestamp::from_second(seconds as i64).ok());
    let expires_at = expires_at.ok_or_else(|| TokenError::Claim("exp".to_owned()))? + SignedDuration::from_secs(expected.leeway_s as i64);
    Ok(Bearer { owner, subject, expires_at, scopes: scopes(claims.get(&expected.scope_claim), &expected.scope_prefix) })
}

fn refused(kind: &ErrorKind) -> TokenError {
    match kind {
        ErrorKind::InvalidSignature | ErrorKind::InvalidKeyFormat | ErrorKind::Provider(_) => TokenError::Signature,
        ErrorKind::InvalidAlgorithm | ErrorKind::UnsupportedAlgorithm => TokenError::Algorithm,
        ErrorKind::ExpiredSignature => TokenError::Expired,
        ErrorKind::ImmatureSignature => TokenError::NotYet,
        ErrorKind::InvalidIssuer => TokenError::Claim("iss".to_owned()),
        ErrorKind::InvalidAudience => TokenError::Claim("aud".to_owned()),
        ErrorKind::MissingRequiredClaim(claim) | ErrorKind::InvalidClaimFormat(claim) => TokenError::Claim(claim.clone()),
        _ => TokenError::NoToken,
    }
}

/// The scopes of this service among those of a token.
fn scopes(claim: Option<&Value>, prefix: &str) -> Vec<Scope> {
    let of = |text: &str| text.strip_prefix(prefix).and_then(Scope::from_name);
    match claim {
        Some(Value::String(text)) => text.split_ascii_whitespace().filter_map(of).collect(),
        Some(Value::Array(list)) => list.iter().filter_map(Value::as_str).filter_map(of).collect(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn scopes_are_read_from_texts_and_lists_and_others_left_alone() {
        assert_eq!(scopes(Some(&json!("openid ventricle:read ventricle:submit")), "ventricle:"), [Scope::Read, Scope::Submit]);
        assert_eq!(scopes(Some(&json!(["ventricle:admin", 7, "admin"])), "ventricle:"), [Scope::Admin]);
        assert_eq!(scopes(Some(&json!("read")), "ventricle:"), []);
        assert_eq!(scopes(None, ""), []);
    }
}
