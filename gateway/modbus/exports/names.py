"""The formats by name, with what each is and who opens it. Imports nothing: the command line's help is quick."""

SUMMARY: dict[str, str] = {
    "ignition": "Ignition 8.1 tags: Tag Browser, Import Tags",
    "kepware": "KEPServerEX tags of the driver Modbus TCP/IP Ethernet",
    "st": "IEC 61131-3 structured text: function block, and a program with one instance a bay",
    "plcopen": "the same as PLCopen XML: CODESYS, WAGO, Schneider",
    "codesys": "PLCopen XML with a program that polls and writes by CODESYS' library ModbusFB",
    "tcpou": "Beckhoff TwinCAT 3 source files, with a program that polls and writes by TF6250",
    "scl": "Siemens SCL source for TIA Portal: S7-1200, S7-1500, with the calls of MB_CLIENT",
    "l5x": "Rockwell Add-On Instruction for Studio 5000",
    "node-red": "Node-RED flow on node-red-contrib-modbus",
    "openplc": "OpenPLC Runtime 3: program and slave devices, two files",
    "csv": "the table, one line a register",
    "json": "the table with all codes and bits",
    "markdown": "the table for people, as in docs/registers.md",
}
