// A client on node-opcua: commands as lines of JSON on stdin, answers on stdout. See __init__.py.
'use strict';
const { OPCUACertificateManager } = require('node-opcua-certificate-manager');
const { AttributeIds, ClientSubscription, MessageSecurityMode, OPCUAClient, SecurityPolicy,
    TimestampsToReturn, Variant, DataType, constructEventFilter, ofType } = require('node-opcua-client');
const { HistoryReadRequest, ReadEventDetails } = require('node-opcua-service-history');

const der = file => Buffer.from(require('fs').readFileSync(file, 'utf8').replace(/-----[^-]*-----|\s/g, ''), 'base64');
const MASK = 0xffff0000;
let client, session, subscription;
let events = [];

const plain = value => {
    if (value === null || value === undefined) return null;
    if (Buffer.isBuffer(value)) return value.toString('hex');
    if (Array.isArray(value)) {
        // 64 bits: high and low
        return value.length === 2 && value.every(Number.isInteger) && value.int64 ? value : value.map(plain);
    }
    if (typeof value === 'number') return Number.isNaN(value) ? null : value;
    if (typeof value === 'object' && 'text' in value) return value.text;
    return typeof value === 'object' ? String(value) : value;
};
const number64 = value => value[0] * 2 ** 32 + value[1];
const content = variant => {
    const wide = variant && (variant.dataType === DataType.Int64 || variant.dataType === DataType.UInt64);
    return wide ? number64(variant.value) : plain(variant && variant.value);
};
const shown = value => ({
    value: content(value.value), status: (value.statusCode.value & MASK) >>> 0,
    at: value.sourceTimestamp ? value.sourceTimestamp.toISOString() : null,
});

const commands = {
    async connect({ url, cert, key, ca, crl, folder, uri }) {
        const options = { endpointMustExist: false, connectionStrategy: { maxRetry: 0 }, requestedSessionTimeout: 60000 };
        const clientCertificateManager = new OPCUACertificateManager({
            rootFolder: folder, automaticallyAcceptUnknownCertificate: true,
        });
        await clientCertificateManager.initialize();
        if (ca) {
            await clientCertificateManager.addIssuer(der(ca), false, true);
            await clientCertificateManager.addRevocationList(der(crl));
        }
        Object.assign(options, { clientCertificateManager });
        if (cert) {
            Object.assign(options, {
                certificateFile: cert, privateKeyFile: key, applicationUri: uri,
                securityMode: MessageSecurityMode.SignAndEncrypt, securityPolicy: SecurityPolicy.Basic256Sha256,
            });
        }
        client = OPCUAClient.create(options);
        await client.connect(url);
        session = await client.createSession();
    },
    async read({ nodes }) {
        const values = await session.read(nodes.map(nodeId => ({ nodeId, attributeId: AttributeIds.Value })));
        return values.map(shown);
    },
    async write({ node, value }) {
        const written = { nodeId: node, attributeId: AttributeIds.Value, value: { value: { dataType: DataType.Boolean, value } } };
        return ((await session.write(written)).value & MASK) >>> 0;
    },
    async history({ node }) {
        const day = 24 * 3600 * 1000;
        const result = await session.readHistoryValue(node, new Date(Date.now() - day), new Date(Date.now() + day));
        return result.historyData.dataValues.map(shown);
    },
    async events({ names, kind }) {
        const day = 24 * 3600 * 1000;
        const historyReadDetails = new ReadEventDetails({
            numValuesPerNode: 0, startTime: new Date(Date.now() - day), endTime: new Date(Date.now() + day),
            filter: constructEventFilter(names, ofType(kind)),
        });
        const { responseHeader, results } = await session.historyRead(
            new HistoryReadRequest({ historyReadDetails, nodesToRead: [{ nodeId: 'i=2253' }] }));
        if (responseHeader.serviceResult.value) throw new Error(responseHeader.serviceResult.name);
        return results[0].historyData.events.map(row => Object.fromEntries(
            row.eventFields.map((field, n) => [names[n].replace('2:', ''), content(field)])));
    },
    async call({ node, method, event, comment }) {
        const inputArguments = event ? [
            new Variant({ dataType: DataType.ByteString, value: Buffer.from(event, 'hex') }),
            new Variant({ dataType: DataType.LocalizedText, value: { text: comment } }),
        ] : [];
        const result = await session.call({ objectId: node, methodId: method, inputArguments });
        return {
            status: (result.statusCode.value & MASK) >>> 0, outputs: (result.outputArguments || []).map(content),
        };
    },
    async subscribe() {
        const names = ['EventId', 'EventType', 'SourceName', 'Severity', 'Message', 'ConditionName', 'Retain',
            'ActiveState.Id', 'AckedState.Id', '2:Bay', '2:end', '2:times_in_place', 'data_types'];
        subscription = ClientSubscription.create(session, {
            requestedPublishingInterval: 100, requestedLifetimeCount: 1000, requestedMaxKeepAliveCount: 10,
            publishingEnabled: true,
        });
        const item = await subscription.monitor(
            { nodeId: 'i=2253', attributeId: AttributeIds.EventNotifier },
            { samplingInterval: 0, queueSize: 100, filter: constructEventFilter(names) }, TimestampsToReturn.Both);
        item.on('changed', fields => events.push(Object.fromEntries(
            fields.map((field, n) => [names[n].replace('2:', ''), content(field)]))));
        // The conditions that are there already.
        const refreshed = await session.call({
            objectId: 'i=2782', methodId: 'i=3875',
            inputArguments: [new Variant({ dataType: DataType.UInt32, value: subscription.subscriptionId })],
        });
        return (refreshed.statusCode.value & MASK) >>> 0;
    },
    async seen() {
        const found = events;
        events = [];
        return found;
    },
};

const lines = require('readline').createInterface({ input: process.stdin });
(async () => {
    for await (const line of lines) {
        const what = JSON.parse(line);
        let answer;
        try {
            answer = { answer: (await commands[what.do](what)) ?? null };
        } catch (error) {
            answer = { error: String(error.message || error), code: null };
        }
        console.log('> ' + JSON.stringify(answer));
    }
    process.exit(0);
})();
