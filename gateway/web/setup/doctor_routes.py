"""The doctor's examination for the pages and for programs. `security` has checked who calls."""

from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.server.services import WebServices
from gateway.web.setup.models import DoctorView, FindingView

ADDRESSES = ApiAddresses("/api/doctor", least=Level.TECHNICIAN)


@ADDRESSES.get(
    "",
    "doctor",
    "what gateway doctor finds beside the running gateway",
    errors={503: "the process that examines has failed, or does not answer"},
)
async def _doctor(services: WebServices) -> DoctorView:
    """Takes up to a minute where a broker does not answer. The same for ten seconds."""
    lines, complete = await services.devices.examined()
    return DoctorView(findings=[FindingView.model_validate(line) for line in lines], complete=complete)
