//! What of a request for an association is accepted (PS3.8 7.1): who may call, and which objects in which encoding.

use super::{APPLICATION_CONTEXT, VERIFICATION, own_variables};
use crate::intake::{self, TransferSyntax};
use dicom_ul::pdu::{
    AssociationAC, AssociationRJ, AssociationRJResult, AssociationRJServiceProviderASCEReason,
    AssociationRJServiceProviderPresentationReason, AssociationRJServiceUserReason, AssociationRJSource, AssociationRQ,
    PresentationContextProposed, PresentationContextResult, PresentationContextResultReason, UserVariableItem,
};

/// A presentation context that was accepted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Context {
    pub(super) id: u8,
    pub(super) class_uid: String,
    pub(super) transfer_syntax: String,
}

/// An association that was accepted.
#[derive(Debug)]
pub(super) struct Accepted {
    pub(super) answer: AssociationAC,
    pub(super) contexts: Vec<Context>,
    /// Longest protocol data unit that the other side takes; 0: any.
    pub(super) most_bytes: u32,
}

/// Judges a request. An empty list of callers lets everybody in.
pub(super) fn judge(request: &AssociationRQ, callers: &[String], read: &[TransferSyntax]) -> Result<Accepted, AssociationRJ> {
    if request.protocol_version & 1 == 0 {
        let reason = AssociationRJServiceProviderASCEReason::ProtocolVersionNotSupported;
        return Err(for_good(AssociationRJSource::ServiceProviderASCE(reason)));
    }
    if plain(&request.application_context_name) != APPLICATION_CONTEXT {
        let reason = AssociationRJServiceUserReason::ApplicationContextNameNotSupported;
        return Err(for_good(AssociationRJSource::ServiceUser(reason)));
    }
    if !callers.is_empty() && !callers.iter().any(|caller| caller == plain(&request.calling_ae_title)) {
        return Err(for_good(AssociationRJSource::ServiceUser(AssociationRJServiceUserReason::CallingAETitleNotRecognized)));
    }
    let (mut contexts, mut results) = (Vec::new(), Vec::new());
    for proposed in &request.presentation_contexts {
        let (reason, transfer_syntax) = match accept(proposed, read) {
            Ok(transfer_syntax) => (PresentationContextResultReason::Acceptance, transfer_syntax),
            // Not significant then, but it must be there.
            Err(reason) => (reason, super::IMPLICIT_LITTLE_ENDIAN),
        };
        if reason == PresentationContextResultReason::Acceptance {
            let class_uid = plain(&proposed.abstract_syntax).to_owned();
            contexts.push(Context { id: proposed.id, class_uid, transfer_syntax: transfer_syntax.to_owned() });
        }
        results.push(PresentationContextResult { id: proposed.id, reason, transfer_syntax: transfer_syntax.to_owned() });
    }
    let most_bytes = request.user_variables.iter().find_map(|variable| match variable {
        UserVariableItem::MaxLength(bytes) => Some(*bytes),
        _ => None,
    });
    let answer = AssociationAC {
        protocol_version: 1,
        application_context_name: APPLICATION_CONTEXT.to_owned(),
        // Sent back as they came, and not significant.
        called_ae_title: ascii(&request.called_ae_title),
        calling_ae_title: ascii(&request.calling_ae_title),
        presentation_contexts: results,
        user_variables: own_variables(),
    };
    Ok(Accepted { answer, contexts, most_bytes: most_bytes.unwrap_or(0) })
}

/// There is no room now.
pub(super) fn no_room() -> AssociationRJ {
    let reason = AssociationRJServiceProviderPresentationReason::LocalLimitExceeded;
    AssociationRJ { result: AssociationRJResult::Transient, source: AssociationRJSource::ServiceProviderPresentation(reason) }
}

/// The service stops.
pub(super) fn stopping() -> AssociationRJ {
    let reason = AssociationRJServiceProviderPresentationReason::TemporaryCongestion;
    AssociationRJ { result: AssociationRJResult::Transient, source: AssociationRJSource::ServiceProviderPresentation(reason) }
}

fn for_good(source: AssociationRJSource) -> AssociationRJ {
    AssociationRJ { result: AssociationRJResult::Permanent, source }
}

/// The first of the proposed encodings that is read here, as the sender has the object in it; one in which values may have changed only if
/// there is no other.
fn accept(proposed: &PresentationContextProposed, read: &[TransferSyntax]) -> Result<&'static str, PresentationContextResultReason> {
    let class_uid = plain(&proposed.abstract_syntax);
    let echoed = [super::IMPLICIT_LITTLE_ENDIAN, super::EXPLICIT_LITTLE_ENDIAN].map(|uid| TransferSyntax { uid, lossy: false });
    let read = if class_uid == VERIFICATION {
        &echoed
    } else if intake::STORAGE_CLASSES.contains(&class_uid) {
        read
    } else {
        return Err(PresentationContextResultReason::AbstractSyntaxNotSupported);
    };
    let place = |syntax: &TransferSyntax| proposed.transfer_syntaxes.iter().position(|other| plain(other) == syntax.uid);
    let first = read.iter().filter_map(|syntax| Some((syntax.lossy, place(syntax)?, syntax.uid))).min();
    first.map(|(.., uid)| uid).ok_or(PresentationContextResultReason::TransferSyntaxesNotSupported)
}

/// Without padding.
fn plain(text: &str) -> &str {
    text.trim_matches([' ', '\0'])
}

/// A title that can be written again.
fn ascii(title: &str) -> String {
    title.chars().map(|letter| if matches!(letter, ' '..='~') { letter } else { '?' }).take(super::LONGEST_TITLE).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NM: &str = "1.2.840.10008.5.1.4.1.1.20";
    const RLE: &str = "1.2.840.10008.1.2.5";
    const LOSSY: &str = "1.2.840.10008.1.2.4.50";

    fn read() -> Vec<TransferSyntax> {
        let lossless = intake::transfer_syntaxes(&intake::Limits::default());
        assert!(lossless.iter().all(|syntax| !syntax.lossy && syntax.uid != LOSSY), "without a decoder nothing compressed is read");
        lossless.into_iter().chain([TransferSyntax { uid: LOSSY, lossy: true }]).collect()
    }

    fn request(contexts: &[(u8, &str, &[&str])]) -> AssociationRQ {
        let proposed = |(id, class_uid, syntaxes): &(u8, &str, &[&str])| PresentationContextProposed {
            id: *id,
            abstract_syntax: (*class_uid).to_owned(),
            transfer_syntaxes: syntaxes.iter().map(|&syntax| syntax.to_owned()).collect(),
        };
        AssociationRQ {
            protocol_version: 1,
            calling_ae_title: "CALLER".to_owned(),
            called_ae_title: "ANY-SCP".to_owned(),
            application_context_name: APPLICATION_CONTEXT.to_owned(),
            presentation_contexts: contexts.iter().map(proposed).collect(),
            user_variables: vec![UserVariableItem::MaxLength(16384)],
        }
    }

    #[test]
    fn what_is_read_here_is_accepted_in_the_encoding_named_first() {
        let accepted = judge(
            &request(&[
                (1, VERIFICATION, &[super::super::IMPLICIT_LITTLE_ENDIAN]),
                (3, NM, &["1.2.840.10008.1.2.4.100", LOSSY, RLE, super::super::EXPLICIT_LITTLE_ENDIAN]),
                (5, "1.2.840.10008.5.1.4.1.1.5\0", &[super::super::EXPLICIT_LITTLE_ENDIAN]),
                (7, "1.2.840.10008.5.1.4.1.1.2", &[super::super::EXPLICIT_LITTLE_ENDIAN]),
                (9, NM, &["1.2.840.10008.1.2.4.100"]),
                (11, NM, &[]),
                (13, NM, &[LOSSY]),
            ]),
            &[],
            &read(),
        )
        .unwrap();
        let results: Vec<_> = accepted.answer.presentation_contexts.iter().map(|result| (result.id, result.reason.clone() as u8)).collect();
        assert_eq!(results, [(1, 0), (3, 0), (5, 0), (7, 3), (9, 4), (11, 4), (13, 0)]);
        let contexts: Vec<_> = accepted.contexts.iter().map(|context| (context.id, context.transfer_syntax.as_str())).collect();
        assert_eq!(contexts, [(1, super::super::IMPLICIT_LITTLE_ENDIAN), (3, RLE), (5, super::super::EXPLICIT_LITTLE_ENDIAN), (13, LOSSY)]);
        assert_eq!(accepted.most_bytes, 16384);
    }

    #[test]
    fn who_is_not_on_the_list_is_rejected_for_good() {
        let callers = ["PACS".to_owned(), "CALLER".to_owned()];
        assert!(judge(&request(&[]), &callers, &read()).is_ok());
        let rejected = judge(&request(&[]), &callers[..1], &read()).unwrap_err();
        assert_eq!(rejected.result, AssociationRJResult::Permanent);
        assert_eq!(rejected.source, AssociationRJSource::ServiceUser(AssociationRJServiceUserReason::CallingAETitleNotRecognized));
        let other = AssociationRQ { application_context_name: "1.2.3".to_owned(), ..request(&[]) };
        assert_eq!(judge(&other, &[], &read()).unwrap_err().result, AssociationRJResult::Permanent);
        let version = AssociationRQ { protocol_version: 2, ..request(&[]) };
        assert_eq!(judge(&version, &[], &read()).unwrap_err().result, AssociationRJResult::Permanent);
    }
}
